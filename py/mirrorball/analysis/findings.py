"""Where did a run go wrong, and why? Moments of a log that a person should look at, each with its likely causes.

They are found by the crates, so that `mirrorball report`, the view and a script list the same ones. A moment is found by what
the log itself says: the stated uncertainty, the truth where there is one, the wheels between two images. Causes are
measurements that differ from those of the rest of the run at that moment, so that no threshold has to fit a certain robot or
hall.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirrorball import _core
from mirrorball.analysis.tables import as_log, cycles
from mirrorball.arguments import checked
from mirrorball.log import Log

__all__ = ["Finding", "findings", "findings_table", "images_of"]


@dataclass(frozen=True)
class Finding:
    """A moment of a run: what happened, how badly, and what was unusual."""

    kind: str
    """error, overconfident, uncertain, lost, leap, slip, light, drift, unusable, gap or dropped."""
    start_s: float
    stop_s: float
    worst_s: float
    size: float
    """Largest value in the moment, in the unit of its kind: metres, seconds for gaps, a ratio for light."""
    causes: tuple[str, ...]
    """What differed from the rest of the run, the strongest first."""
    severity: str
    """bad: the pose is wrong or unknown. warning: it is uncertain, or a measurement is missing. note: it need not suffer."""
    sentence: str
    """The finding in one sentence."""


@checked
def findings(log: Log | str | Path) -> list[Finding]:
    """The moments of a log that deserve a look, in order of time.

    Errors need truth in the log (`sim --record`). Without truth, uncertain poses, leaps against the wheels, lost robots, slip,
    light, drift of the map, gaps and unusable images are found.
    """
    path = as_log(log).path
    count, found = _core.findings(path)
    if count == 0:
        raise ValueError(f"{path} has no cycle")
    return [
        Finding(kind, start, stop, worst, size, tuple(causes), severity, sentence)
        for kind, severity, start, stop, worst, size, causes, sentence in found
    ]


@checked
def findings_table(found: list[Finding]) -> pd.DataFrame:
    """One row a finding: kind, start_s, stop_s, worst_s, size, causes, sentence, severity."""
    rows = [(each.kind, each.start_s, each.stop_s, each.worst_s, each.size, ", ".join(each.causes), each.sentence,
             each.severity) for each in found]  # fmt: skip
    columns = ["kind", "start_s", "stop_s", "worst_s", "size", "causes", "sentence", "severity"]
    return pd.DataFrame(rows, columns=columns)


@checked
def images_of(log: Log | str | Path, found: list[Finding]) -> dict[Finding, NDArray[np.uint8]]:
    """The image at the worst moment of each finding, rows × columns × (red, green, blue), where the log has one."""
    log = as_log(log)
    if not log.message_counts.get("/camera/image"):
        return {}
    pictures = {}
    # Log times of a robot are wall-clock time; stamps of cycles are not.
    run = cycles(log)
    logged = log.columns("/cycle")["stamp_s"]
    for finding in found:
        at = int(np.argmin(np.abs(run["stamp_s"].to_numpy() - finding.worst_s)))
        for _, image in log.images(start_s=logged[at] - 0.005, stop_s=logged[at] + 0.005):
            pictures[finding] = image
            break
    return pictures
