# %% Cycle, Pose
from mirrorball import Simulation
from mirrorball.estimates import Cycle, Pose

simulation = Simulation("config/scenarios/demo.toml", seed=1)
pipeline = simulation.pipeline()
cycles: list[Cycle] = []
for _ in range(6):
    cycles += [cycle for sample in simulation.step().samples if (cycle := pipeline.process(sample))]
pose: Pose | None = cycles[-1].pose

# %% Estimate, Fit
from mirrorball.estimates import Estimate, Fit

estimate: Estimate = cycles[-1].estimate
fit: Fit = estimate.fit
print(estimate.mode, estimate.reason, fit.on_markings, fit.residual_m)

# %% RunnerUp
from mirrorball.estimates import RunnerUp

others: tuple[RunnerUp, ...] = estimate.runners_up
print([(other.pose, other.probability) for other in others])

# %% Certificate, Advice
from mirrorball.estimates import Advice, Certificate

# None while a single pose is tracked.
certificate: Certificate | None = estimate.certificate
advice: Advice | None = estimate.advice
if certificate is not None:
    print(certificate.answer_share, certificate.others_share_max)
if advice is not None:
    print(advice.text, advice.motion)

# %% TrackedObject
from mirrorball.estimates import TrackedObject

robots: tuple[TrackedObject, ...] = tuple(cycles[-1].robots)
print([(robot.position_m, robot.probability) for robot in robots])
