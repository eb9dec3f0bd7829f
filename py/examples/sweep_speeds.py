# %% [markdown]
# # How does speed change the localization error?
# Many runs on all cores. An interrupted sweep resumes.
# `python py/examples/sweep_speeds.py out/speeds [seeds] [seconds]`

# %%
from __future__ import annotations

import sys
from pathlib import Path

from mirrorball.sweep import grid, sweep

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/speeds")
seeds = int(sys.argv[2]) if len(sys.argv) > 2 else 5
duration = float(sys.argv[3]) if len(sys.argv) > 3 else 20.0
scenario = Path(__file__).parents[2] / "config" / "scenarios" / "tracks_18x12.toml"

# %%
runs = grid(scenario, seeds=range(seeds), change={"path.speed": [1.0, 3.0]}, duration_s=duration)
found = sweep(runs, folder=out)

# %%
errors = found.groupby("path.speed")[["position_error_m.mean", "position_error_m.max", "lost"]]
print(errors.mean())
