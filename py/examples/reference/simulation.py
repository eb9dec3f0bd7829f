# %% Run, simulate
from mirrorball.simulation import Run, simulate

summary = simulate(Run("config/scenarios/demo.toml", seed=3, duration_s=0.3))
print(summary["frames"], summary["position_error_m"])

# %% bundle_run
from mirrorball.simulation import bundle_run

run = bundle_run("config/scenarios/demo.toml", seed=4, duration_s=0.3)
print(sorted(run.files))

# %% Simulation
from mirrorball.simulation import Simulation

simulation = Simulation("config/scenarios/demo.toml", seed=1, images=False)
simulation.kidnap([1.0, 2.0, 0.0])

# %% Step
from mirrorball.simulation import Step

step: Step = simulation.step([1.0, 0.0, 0.0])
print(step.truth.pose, step.ended)
