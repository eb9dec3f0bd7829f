"""Analysis of runs: logs as tables, errors against truth, times, drop-outs, exposure; figures, reports, comparisons.

>>> from mirrorball.analysis import Log, cycles, report
>>> table = cycles(Log("game.mcap"))  # doctest: +SKIP
>>> report("game.mcap", folder="out/game")  # doctest: +SKIP

Needs `pip install mirrorball[analysis]` (pandas, pyarrow); videos need `mirrorball[video]`.
"""

import importlib
from types import ModuleType

from mirrorball.analysis.findings import Finding, findings, findings_table, images_of
from mirrorball.analysis.metrics import difference, dropouts, paired_difference, summary
from mirrorball.analysis.reporting import Report, compare, report
from mirrorball.analysis.tables import cycles, exposure, points, stream, table, write_parquet
from mirrorball.log import Log, LogError

__all__ = [
    "Finding",
    "Log",
    "LogError",
    "Report",
    "compare",
    "cycles",
    "difference",
    "dropouts",
    "exposure",
    "findings",
    "findings_table",
    "images_of",
    "paired_difference",
    "points",
    "report",
    "stream",
    "summary",
    "table",
    "write_parquet",
]


def __getattr__(name: str) -> ModuleType:
    # Imported when it is first used: it needs OpenCV, which is not installed everywhere.
    if name == "video":
        return importlib.import_module("mirrorball.analysis.video")
    raise AttributeError(f"module 'mirrorball.analysis' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "video"]
