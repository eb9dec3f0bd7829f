# %% Sample, sample_from_core
from mirrorball import Simulation
from mirrorball.samples import Sample, sample_from_core

simulation = Simulation("config/scenarios/demo.toml", seed=1)
samples: list[Sample] = [sample for _ in range(3) for sample in simulation.step([0.5, 0.0, 0.1]).samples]
same = sample_from_core(("odometry", 0.01, (0.02, 0.0, 0.0)))

# %% OdometrySample
from mirrorball.samples import OdometrySample

print([sample.motion for sample in samples if isinstance(sample, OdometrySample)][:2])

# %% ImuSample
from mirrorball.samples import ImuSample

print([sample.specific_force_mps2 for sample in samples if isinstance(sample, ImuSample)][:2])

# %% CompassSample
from mirrorball.samples import CompassSample

print([sample.heading_rad for sample in samples if isinstance(sample, CompassSample)][:2])

# %% CommandSample
from mirrorball.samples import CommandSample

pipeline = simulation.pipeline()
pipeline.process(CommandSample(0.0, (0.5, 0.0, 0.1)))

# %% TruthSample
from mirrorball.samples import TruthSample

print([sample.pose for sample in samples if isinstance(sample, TruthSample)][-1])

# %% ImageSample
from mirrorball.samples import ImageSample

image = next(sample.image for sample in samples if isinstance(sample, ImageSample))
