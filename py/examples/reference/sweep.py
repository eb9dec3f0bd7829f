# %% grid
from mirrorball.sweep import grid

runs = grid("config/scenarios/tracks_18x12.toml", seeds=range(2), change={"path.speed": [1.0, 2.0]}, duration_s=0.2)

# %% sweep
from mirrorball.sweep import sweep

found = sweep(runs, folder="speeds", progress=False)
print(found.groupby("path.speed")["position_error_m.mean"].mean())
