"""`mirrorball import`: the topics of a bag, or what became of them, as text or JSON."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from mirrorball.bags.importing import ImportSummary, import_bag
from mirrorball.bags.topics import BagTopic, Selection, list_topics

__all__ = ["import_folder", "topic_list"]


def topic_list(bag: str, as_json: bool) -> str:
    """What `--list` prints."""
    topics = list_topics(bag)
    if as_json:
        return json.dumps({"topics": [asdict(topic) for topic in topics]})
    return "\n".join(_topic_line(topic) for topic in topics) or "no topics"


def import_folder(bag: str, folder: str, options: str, as_json: bool) -> tuple[str, list[str]]:
    """Writes the folder. Returns what to print, and warnings. `options` in JSON: selection, start_s, stop_s, base_frame."""
    chosen: dict[str, Any] = json.loads(options)
    selection = Selection(**chosen.pop("selection"))
    if sys.stderr.isatty():
        from tqdm import tqdm

        with tqdm(unit="messages", file=sys.stderr) as bar:

            def progress(done: int, total: int) -> None:
                bar.total = total
                bar.update(done - bar.n)

            summary = import_bag(bag, folder, selection=selection, progress=progress, **chosen)
    else:
        summary = import_bag(bag, folder, selection=selection, **chosen)
    return (json.dumps(asdict(summary)) if as_json else _text(summary)), list(summary.warnings)


def _topic_line(topic: BagTopic) -> str:
    return f"{topic.messages:8}  {topic.role or '-':9} {topic.name}  {topic.type}"


def _text(summary: ImportSummary) -> str:
    begin = datetime.fromtimestamp(summary.start_s, UTC).isoformat(sep=" ", timespec="milliseconds")
    lines = [f"{summary.stop_s - summary.start_s:.3f} s from {begin}"]
    for topic in summary.topics:
        span = ""
        if topic.first_s is not None and topic.last_s is not None:
            span = f", stamps {topic.first_s:.3f} to {topic.last_s:.3f} s"
        lines.append(f"{topic.file}: {topic.rows} rows of {topic.topic}{span}")
        lines += [f"    skipped {count}: {reason}" for reason, count in topic.skipped.items()]
        lines += [f"    {note}" for note in topic.notes]
    if summary.unused:
        lines.append(f"not used: {', '.join(topic.name for topic in summary.unused)}")
    return "\n".join(lines)
