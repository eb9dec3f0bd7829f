"""`mirrorball report`: the page of one log or of two, and its findings as text or JSON."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

__all__ = ["as_json", "as_text", "report"]


def report(log: str, second: str | None, folder: str) -> dict[str, Any]:
    """Writes the page into a folder. Keys: page, frames, findings (kind, start_s, stop_s, size, causes, sentence), warnings.

    With a second log: page, difference (mean errors on frames of one stamp, and the interval of their difference), warnings.
    The warnings name truncated logs.
    """
    try:
        from mirrorball.analysis import reporting
        from mirrorball.analysis.findings import findings_table
        from mirrorball.analysis.metrics import paired_difference
        from mirrorball.log import Log
    except ModuleNotFoundError as error:
        raise ValueError(
            f"no module {error.name}: `mirrorball report` needs mirrorball[analysis] or requirements.txt"
        ) from None
    logs = [Log(path) for path in (log, second) if path is not None]
    for each in logs:
        if "/cycle" not in each.topics:
            raise ValueError(f"{each.path}: no cycle in this log (`mirrorball recover` reads what a killed run left)")
    warnings = [said for said in map(reporting.incomplete, logs) if said]
    if second is None:
        written = reporting.report(log, folder=folder)
        found = findings_table(list(written.findings)).to_dict(orient="records")
        return {"page": _printable(written.page), "frames": len(written.cycles[0]), "findings": found, "warnings": warnings}
    written = reporting.compare(log, second, folder=folder)
    first_run, second_run = written.cycles
    known = all(run["error_m"].notna().any() for run in written.cycles)
    compared = paired_difference(first_run, second_run) if known else None
    return {"page": _printable(written.page), "difference": compared, "warnings": warnings}


def _printable(path: Path) -> str:
    """A path whose bytes are no UTF-8 has marks in their place."""
    return os.fsencode(path).decode(errors="replace")


def as_json(result: dict[str, Any]) -> str:
    """The result object as JSON."""
    return json.dumps(result)


def as_text(result: dict[str, Any]) -> str:
    """The findings, or the difference, and where the page is."""
    last = [*result["warnings"], f"page: {result['page']}"]
    if "findings" in result:
        lines = [f"{row['start_s']:8.2f} s  {row['kind']:13}  {row['sentence']}" for row in result["findings"]]
        return "\n".join([*(lines or ["no findings"]), *last])
    found = result["difference"]
    if found is None:
        return "\n".join(last)
    compared = (
        f"mean error {100.0 * found['mean_first']:.2f} and {100.0 * found['mean_second']:.2f} cm, difference "
        f"{100.0 * found['difference']:.2f} cm (95 %: {100.0 * found['low']:.2f} to {100.0 * found['high']:.2f} cm)"
    )
    return "\n".join([compared, *last])
