# %% [markdown]
# # Analysis of a game
# A log of `mirrorball sim SCENARIO --record game.mcap` (or of a robot) as tables, figures and a page.
# Run it cell by cell in a notebook, or whole: `mirrorball script py/examples/analyse_log.py game.mcap out/game`

# %%
from __future__ import annotations

import sys
from pathlib import Path

from mirrorball.analysis import Log, cycles, dropouts, report, summary, table

log = Log(sys.argv[1] if len(sys.argv) > 1 else "game.mcap")
out = Path(sys.argv[2] if len(sys.argv) > 2 else "out/game")
print(log.about["source"], log.topics)

# %% [markdown]
# One row a cycle: estimate, deviations, truth, errors, times, counts.

# %%
run = cycles(log)
print(summary(run))
print(dropouts(run))

# %% [markdown]
# Are the errors as large as the estimate says? The normalised error squared is 3 on average if they are.

# %%
print("normalised error squared:", run["nees"].mean())

# %% [markdown]
# Any topic is a table too: how much the wheels reported.

# %%
odometry = table(log, "/odometry")
print("metres by the wheels:", (odometry["dx_m"] ** 2 + odometry["dy_m"] ** 2).pow(0.5).sum())

# %% [markdown]
# Everything on one page.

# %%
print(report(log, folder=out).page)
