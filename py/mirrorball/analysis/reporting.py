"""Reports of runs: one self-contained HTML page about one log, or about two side by side."""

from __future__ import annotations

import html
import os
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from mirrorball.analysis import figures
from mirrorball.analysis.findings import Finding, findings, images_of
from mirrorball.analysis.metrics import difference, dropouts, paired_difference, shares, summary
from mirrorball.analysis.tables import as_log, cycles, exposure
from mirrorball.arguments import checked
from mirrorball.html_page import inline, picture, png_bytes, table, write
from mirrorball.log import Log
from mirrorball.records import Record

FINDINGS_MAX = 200
"""Findings that a page lists."""
PICTURES_MAX = 6
"""Findings whose images a page shows."""
PICTURED = ("error", "overconfident", "lost", "leap", "uncertain", "unusable", "light")
"""Kinds of findings in the order in which their images are worth a look."""


@dataclass(frozen=True, eq=False)
class Report(Record):
    """Tables of a report, and its page."""

    page: Path
    cycles: tuple[pd.DataFrame, ...]
    summary: pd.DataFrame
    dropouts: pd.DataFrame
    findings: tuple[Finding, ...] = ()


@checked
def report(log: Log | str | Path, *, folder: str | Path, images_every: int = 10) -> Report:
    """Writes index.html about one log. The light is measured in each `images_every`-th image; 0 leaves it out."""
    log = as_log(log)
    run = cycles(log)
    if run.empty:
        raise ValueError(f"{log.path} has no cycle")
    missing, found = dropouts(run), summary(run)
    name = _name(log)
    moments = findings(log)
    sections = [
        *_notices(log),
        table(["", ""], [[key, value] for key, value in sorted(log.about.items())]),
        _mode_table(run),
        _summary_table(found),
        *_finding_sections(log, moments),
        picture(figures.path({name: run}, lines=figures.markings(log)), "Path"),
    ]
    if run["error_m"].notna().any():
        sections.append(picture(figures.errors({name: run}), "Error against truth, and two standard deviations as stated"))
    sections.append(picture(figures.times({name: run}), "Stages"))
    if images_every and log.message_counts.get("/camera/image"):
        sections.append(picture(figures.light(exposure(log, every=images_every)), "Light"))
    sections.append("<h2>Missing</h2>")
    sections.append(_dropout_table(missing))
    page = write(Path(folder), title=name, sections=sections)
    return Report(page=page, cycles=(run,), summary=found, dropouts=missing, findings=tuple(moments))


@checked
def compare(first: Log | str | Path, second: Log | str | Path, *, folder: str | Path) -> Report:
    """Writes index.html about two logs of one drive (or of two): their figures side by side, and how far apart they are."""
    logs = (as_log(first), as_log(second))
    runs = (cycles(logs[0]), cycles(logs[1]))
    names = [_name(log) for log in logs]
    if names[0] == names[1]:
        names = [f"{name} ({number})" for number, name in enumerate(names, start=1)]
    both = dict(zip(names, runs, strict=True))
    found = pd.concat({name: summary(run) for name, run in both.items()}, axis=1)
    apart = difference(*runs)
    sections = [
        "".join(f"<h2>{name}</h2>{_mode_table(run)}" for name, run in both.items()),
        "".join(f"<h2>{name}</h2>{_summary_table(summary(run))}" for name, run in both.items()),
        table(["Frames of one stamp", "Farthest apart", "Mean apart"],
              [[str(len(apart)), f"{100.0 * apart['apart_m'].max():.2f} cm", f"{100.0 * apart['apart_m'].mean():.2f} cm"]]),
        picture(figures.path(both, lines=figures.markings(logs[0])), "Paths"),
    ]  # fmt: skip
    if all(run["error_m"].notna().any() for run in runs) and len(apart):
        sections.insert(2, _paired_table(*runs))
    if any(run["error_m"].notna().any() for run in runs):
        sections.append(picture(figures.errors(both), "Errors against truth"))
    sections.append(picture(figures.times(both), "Stages"))
    page = write(Path(folder), title=" and ".join(names), sections=[*_notices(*logs), *sections])
    missing = pd.concat([dropouts(run).assign(run=name) for name, run in both.items()], ignore_index=True)
    return Report(page=page, cycles=runs, summary=found, dropouts=missing)


def incomplete(log: Log) -> str | None:
    """What a truncated log lacks, in a sentence; None for a complete one."""
    return None if log.complete else f"{_name(log)}: the log is truncated, and read up to its last complete chunk"


def _notices(*logs: Log) -> list[str]:
    """What the page says first about truncated logs."""
    return [f"<p>{html.escape(said)}</p>" for said in map(incomplete, logs) if said]


def _name(log: Log) -> str:
    """What the page calls a log. Bytes that are no UTF-8 have marks in their place."""
    return os.fsencode(log.path.stem).decode(errors="replace")


def _finding_sections(log: Log, moments: list[Finding]) -> list[str]:
    """The list of findings, and the images of the worst of them."""
    if not moments:
        return ["<h2>Findings</h2><p>none</p>"]
    rows = [[each.kind, f"{each.start_s:.2f}", f"{each.stop_s:.2f}", each.sentence] for each in moments[:FINDINGS_MAX]]
    more = f"<p>and {len(moments) - FINDINGS_MAX} more</p>" if len(moments) > FINDINGS_MAX else ""
    worst = sorted(moments, key=lambda each: PICTURED.index(each.kind) if each.kind in PICTURED else len(PICTURED))
    pictures = images_of(log, worst[:PICTURES_MAX])
    return [
        "<h2>Findings</h2>",
        table(["", "from / s", "to / s", ""], rows) + more,
        *(inline(png_bytes(image), each.sentence) for each, image in pictures.items()),
    ]


def _paired_table(first: pd.DataFrame, second: pd.DataFrame) -> str:
    found = paired_difference(first, second)
    cells = [f"{100.0 * found[name]:.2f} cm" for name in ("mean_first", "mean_second", "difference")]
    interval = f"{100.0 * found['low']:.2f} to {100.0 * found['high']:.2f} cm"
    head = ["Error on frames of one stamp: first", "second", "second less first", "95 % interval"]
    return table(head, [[*cells, interval]])


def _mode_table(run: pd.DataFrame) -> str:
    seconds = run["stamp_s"].iloc[-1] - run["stamp_s"].iloc[0]
    rows = [["frames", str(len(run))], ["seconds", f"{seconds:.1f}"]]
    rows += [[mode, f"{100.0 * share:.2f} %"] for mode, share in shares(run).items()]
    return table(["", ""], rows)


def _summary_table(found: pd.DataFrame) -> str:
    return table(["", *map(str, found.columns)], [[str(name), *(f"{value:.4g}" for value in row)] for name, row in
                                                  zip(found.index, found.to_numpy(), strict=True)])  # fmt: skip


def _dropout_table(missing: pd.DataFrame) -> str:
    if missing.empty:
        return "<p>nothing</p>"
    rows = [[row.kind, f"{row.start_s:.3f}", f"{row.stop_s:.3f}", row.detail] for row in missing.head(200).itertuples()]
    more = f"<p>and {len(missing) - 200} more</p>" if len(missing) > 200 else ""
    return table(["", "from / s", "to / s", ""], rows) + more
