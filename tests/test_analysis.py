"""Tables, metrics and reports of a recorded game, and of synthetic tables for what a game lacks."""

import json
import runpy
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from conftest import PROGRAM, ROOT
from mirrorball import simulate
from mirrorball.analysis import (
    Log,
    LogError,
    command,
    compare,
    cycles,
    difference,
    dropouts,
    exposure,
    findings,
    findings_table,
    paired_difference,
    points,
    report,
    stream,
    summary,
    table,
    write_parquet,
)
from mirrorball.analysis.figures import markings
from mirrorball.analysis.reporting import PICTURED
from mirrorball.analysis.video import overlays, write_png, write_video


def test_cycle_table_matches_the_run_summary(game: Path) -> None:
    done = subprocess.run(
        [PROGRAM, "sim", ROOT / "config/scenarios/demo.toml", "--seed", "3", "--duration", "2", "--json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    said = json.loads(done.stdout)
    found = cycles(game)
    assert len(found) == said["frames"] == 60
    errors = summary(found)
    assert errors.loc["position error, cm", "mean"] == pytest.approx(100.0 * said["position_error_m"]["mean"], rel=1e-4)
    assert errors.loc["heading error, °", "largest"] == pytest.approx(np.degrees(said["heading_error_rad"]["max"]), rel=1e-4)
    assert found["line_points"].median() == pytest.approx(said["line_points"], abs=1.0)
    # The first image alone does not exclude another place.
    assert (found["nees"] > 0.0).all() and found["std_x_m"].iloc[1:].between(1e-5, 0.2).all()
    # The mount of camera and mirror is not known at first.
    assert found["std_x_m"].iloc[30:].max() < 0.06 and found["std_x_m"].iloc[-1] < 0.02


def test_streamed_pieces_equal_the_whole_table(game: Path) -> None:
    log = Log(game)
    assert log.complete and log.about["seed"] == "3" and {"robot.toml", "field.toml"} <= log.files().keys()
    assert len(table(log, "/odometry")) == log.message_counts["/odometry"]
    whole = cycles(log)
    pieces = list(stream(log, "/cycle", rows=25))
    assert [len(piece) for piece in pieces] == [25, 25, 10]
    pd.testing.assert_frame_equal(pd.concat(pieces, ignore_index=True), whole)
    assert len(points(log)) == whole["line_points"].sum()
    late = table(log, "/compass", start_s=1.0)
    assert late["stamp_s"].min() >= 1.0 and len(late) < log.message_counts["/compass"]
    with pytest.raises(KeyError, match="no topic /nothing"):
        table(log, "/nothing")


def test_parquet_round_trip_equals_the_cycle_table(game: Path, tmp_path: Path) -> None:
    written = write_parquet(game, folder=tmp_path, topics=["/cycle", "/imu"])
    assert [path.name for path in written] == ["cycle.parquet", "imu.parquet"]
    pd.testing.assert_frame_equal(pd.read_parquet(written[0]), cycles(game), check_dtype=False)


def test_no_topics_are_written_if_none_are_named(game: Path, tmp_path: Path) -> None:
    assert write_parquet(game, folder=tmp_path, topics=[]) == []


def test_counts_below_one_are_refused_by_name(game: Path) -> None:
    with pytest.raises(ValueError, match="invalid every: 0"):
        exposure(game, every=0)
    with pytest.raises(ValueError, match="invalid rows: -1"):
        next(stream(game, "/cycle", rows=-1))
    with pytest.raises(ValueError, match="invalid scale: 0"):
        next(overlays(game, scale=0))
    with pytest.raises(ValueError, match="invalid gap_factor"):
        dropouts(cycles(game), gap_factor=0.0)


def test_truncated_log_is_read_to_its_last_complete_chunk(game: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(game.read_bytes()[: game.stat().st_size // 2])
    log = Log(cut)
    found = cycles(log)
    assert not log.complete and log.about["seed"] == "3" and 10 < len(found) < 60
    assert found["x_m"].tolist() == cycles(game)["x_m"].tolist()[: len(found)]
    assert "robot.toml" in log.files()


def test_non_mcap_file_raises_log_error(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no log at all, but longer than a magic number\n" * 9)
    with pytest.raises(LogError, match=r"notes\.txt is no MCAP file"):
        Log(tmp_path / "notes.txt")
    with pytest.raises(FileNotFoundError):
        Log(tmp_path / "none.mcap")


def test_exposure_statistics_match_the_images(game: Path) -> None:
    found = exposure(game, every=20)
    assert len(found) == 3
    stamp, image = next(Log(game).images())
    assert (found["stamp_s"][0], found["brightness"][0]) == (stamp, pytest.approx(image.mean()))
    # Three channels of 256 levels: 3·ln 256 at most.
    assert found["entropy"].between(8.0, 24.0).all()


def synthetic_cycles(count: int = 10) -> pd.DataFrame:
    stamp = np.arange(count) / 30.0
    return pd.DataFrame({"stamp_s": stamp, "index": np.arange(count), "mode": "tracking", "reason": "", "fault": "",
                         "x_m": stamp, "y_m": 0.0, "theta_rad": 0.0})  # fmt: skip


def test_dropouts_list_dropped_gap_unreadable_and_lost() -> None:
    run = synthetic_cycles(12)
    run.loc[2, "fault"] = "torn"
    run.loc[4:6, ["mode", "reason"]] = ["lost", "Blind"]
    run = run.drop(index=9)
    run.loc[10:, "stamp_s"] += 0.5
    run.loc[11, "stamp_s"] += 0.2
    found = dropouts(run)
    assert found["kind"].tolist() == ["unusable", "lost", "dropped", "gap"]
    assert found["detail"].tolist() == ["torn", "Blind", "1 cycles", "0.233 s between frames"]
    assert (found.loc[1, "start_s"], found.loc[1, "stop_s"]) == (run.loc[4, "stamp_s"], run.loc[6, "stamp_s"])
    assert dropouts(synthetic_cycles()).empty


def test_difference_joins_runs_by_stamp() -> None:
    one, two = synthetic_cycles(10), synthetic_cycles(10).iloc[3:].reset_index(drop=True)
    two["y_m"] += 0.03
    two["theta_rad"] += 2.0 * np.pi - 0.01
    both = difference(one, two)
    assert len(both) == 7
    assert both["apart_m"].to_numpy() == pytest.approx(0.03) and both["apart_rad"].to_numpy() == pytest.approx(0.01)


def test_reports_are_self_contained_html(game: Path, tmp_path: Path) -> None:
    written = report(game, folder=tmp_path / "one", images_every=30)
    text = written.page.read_text()
    pictured = [each for each in written.findings if each.kind in PICTURED]
    assert text.count("<img") == 4 + len(pictured) and "position error" in text and "http" not in text
    both = compare(game, game, folder=tmp_path / "two")
    assert "0.00 cm" in both.page.read_text() and "game (2)" in both.page.read_text()


def test_report_of_a_truncated_log_says_so(game: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(game.read_bytes()[: game.stat().st_size * 2 // 3])
    said = "cut: the log is truncated, and read up to its last complete chunk"
    result = command.report(str(cut), None, str(tmp_path / "one"))
    assert result["warnings"] == [said] and said in command.as_text(result)
    assert said in (tmp_path / "one/index.html").read_text()
    both = command.report(str(game), str(cut), str(tmp_path / "two"))
    assert both["warnings"] == [said] and said in command.as_text(both)
    assert said in (tmp_path / "two/index.html").read_text()
    whole = command.report(str(game), None, str(tmp_path / "three"))
    assert whole["warnings"] == [] and "truncated" not in (tmp_path / "three/index.html").read_text()


def test_annotated_images_differ_from_raw_images(game: Path, tmp_path: Path) -> None:
    stamp, shown = next(overlays(game, scale=2))
    _, image = next(Log(game).images())
    plain = np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)
    changed = (shown != plain).any(axis=2).mean()
    assert stamp == 0.0 and shown.shape == plain.shape and 0.001 < changed < 0.2
    assert [path.name for path in write_png(game, folder=tmp_path, every=40)] == ["00000.000.png", "00001.334.png"]
    assert write_video(game, tmp_path / "game.avi", every=10) == 6
    video = cv2.VideoCapture(str(tmp_path / "game.avi"))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == 6
    with pytest.raises(ValueError, match=r"\.mp4 or \.avi"):
        write_video(game, tmp_path / "game.gif")


def test_log_example_runs(game: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["analyse_log.py", str(game), str(tmp_path / "page")])
    cells = runpy.run_path(str(ROOT / "py/examples/analyse_log.py"))
    assert len(cells["run"]) == 60 and (tmp_path / "page/index.html").is_file()


def test_findings_name_a_kidnap_and_its_cause_and_nothing_in_a_clean_run(game: Path, tmp_path: Path) -> None:
    clean = findings(game)
    assert {each.kind for each in clean} <= {"slip", "uncertain"}
    # The mount of camera and mirror is not known at first.
    assert all(each.stop_s < 0.5 for each in clean if each.kind == "uncertain")
    kidnap = {"time": 2.0, "x": 3.0, "y": 2.0, "theta_deg": 90.0}
    log = tmp_path / "kidnap.mcap"
    scenario = ROOT / "config/scenarios/tracks_18x12.toml"
    simulate(str(scenario), seed=2, duration_s=4.0, record=log, change={"kidnaps": [kidnap]})
    found = findings(log)
    wrong = [each for each in found if each.kind in ("error", "lost", "leap")]
    assert wrong and all(1.9 < each.start_s < 3.0 for each in wrong)
    assert any("points off the markings" in cause for each in wrong for cause in each.causes)
    assert set(findings_table(found).columns) >= {"kind", "start_s", "sentence", "causes", "severity"}
    assert {each.severity for each in wrong} == {"bad"}
    page = report(log, folder=tmp_path / "page")
    assert page.findings == tuple(found)
    text = page.page.read_text()
    assert wrong[0].sentence in text and text.count("data:image/png") >= 4


def test_findings_name_a_change_of_the_light(tmp_path: Path) -> None:
    log = tmp_path / "light.mcap"
    scenario = ROOT / "config/scenarios/light_change.toml"
    simulate(str(scenario), seed=2, duration_s=7.0, record=log, images="none")
    light = [each for each in findings(log) if each.kind == "light"]
    # The light falls to a quarter from 4 to 5 s.
    assert len(light) == 1 and 3.9 < light[0].start_s < 5.7
    assert 2.0 < light[0].size < 8.0


def test_paired_difference_covers_the_truth_and_zero_for_equal_runs() -> None:
    rng = np.random.default_rng(4)
    stamps = np.arange(900) / 30.0
    # Errors that last about a second, as those of a filter.
    common = np.abs(np.convolve(rng.normal(size=900), np.ones(30) / 30.0, "same"))
    run = pd.DataFrame({"stamp_s": stamps, "x_m": 0.0, "y_m": 0.0, "theta_rad": 0.0, "error_m": common})
    worse = run.assign(error_m=common + 0.01 + 0.005 * np.abs(rng.normal(size=900)))
    found = paired_difference(run, worse)
    assert found["low"] < 0.01 + 0.005 * np.sqrt(2.0 / np.pi) < found["high"]
    assert found["low"] > 0.0 and found["frames"] == 900
    same = paired_difference(run, run)
    assert same["low"] == same["high"] == 0.0


def test_every_listed_name_of_the_package_can_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    import mirrorball.analysis

    # This file imports it, others need not.
    monkeypatch.delattr(mirrorball.analysis, "video")
    for name in dir(mirrorball.analysis):
        assert getattr(mirrorball.analysis, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = mirrorball.analysis.nothing


def test_log_without_topics_is_said_to_have_none(game: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(game.read_bytes()[:800])
    log = Log(cut)
    assert log.topics == []
    with pytest.raises(KeyError, match=r"cut\.mcap has no topic /cycle; it has none"):
        cycles(log)
    with pytest.raises(KeyError, match="it has none"):
        log.messages("/pose")
    # Markings and images are drawn where a log has them.
    assert markings(log).shape == (0, 2)
    assert list(overlays(log)) == []
