"""How much does Python add to an image, and do two pipelines use two cores?

    python measure_pipeline.py samples/sequence --rounds 5

The overhead is the time of a call less what the pipeline itself measures for vision and localization, so that what else the
machine does hits both. For two pipelines, one thread processes the images of both one after the other, then two threads do.
"""

import argparse
import csv
import statistics
import threading
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrorball import Pipeline

Images = list[NDArray[np.uint8]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path, help="a recording folder with images")
    parser.add_argument("--rounds", type=int, default=5, help="how often all images are processed")
    options = parser.parse_args()
    with (options.recording / "frames.csv").open(newline="") as table:
        images = [read(options.recording / row["file"]) for row in csv.DictReader(table)]
    calls, stages = time_calls(options.recording, images, options.rounds)
    added = [call - stage for call, stage in zip(calls, stages, strict=True)]
    added_ms, pipeline_ms = statistics.median(added), statistics.median(stages)
    print(f"an image: {pipeline_ms:.2f} ms in the pipeline, {added_ms:.3f} ms by Python ({added_ms / pipeline_ms:.1%})")
    one, two, cpu = time_threads(options.recording, images, options.rounds)
    faster, cores = one / two, cpu / two
    print(f"two pipelines: {one:.2f} s in one thread, {two:.2f} s in two: {faster:.2f} times as fast, {cores:.2f} cores busy")


def read(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path))
    if image is None:
        raise SystemExit(f"{path} is no image")
    return np.asarray(image, dtype=np.uint8)


def time_calls(recording: Path, images: Images, rounds: int) -> tuple[list[float], list[float]]:
    """Milliseconds of each call, and of vision and localization in it, by the pipeline's own clock."""
    pipeline = Pipeline(recording)
    calls, stages = [], []
    for number, image in enumerate(images * rounds):
        started = time.perf_counter()
        cycle = pipeline.image(number / 30.0, image)
        calls.append(1e3 * (time.perf_counter() - started))
        stages.append(sum(cycle.timings_ms.values()))
    # The first images set the colour model and search the whole field.
    return calls[len(images) // 2 :], stages[len(images) // 2 :]


def time_threads(recording: Path, images: Images, rounds: int) -> tuple[float, float, float]:
    """Seconds of two pipelines one after the other, then side by side; and the processor's seconds of the second."""

    def work() -> None:
        pipeline = Pipeline(recording)
        for number, image in enumerate(images * rounds):
            pipeline.image(number / 30.0, image)

    started = time.perf_counter()
    work()
    work()
    one = time.perf_counter() - started
    threads = [threading.Thread(target=work) for _ in range(2)]
    started, busy = time.perf_counter(), time.process_time()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return one, time.perf_counter() - started, time.process_time() - busy


if __name__ == "__main__":
    main()
