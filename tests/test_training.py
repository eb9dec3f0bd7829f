"""The training of the object networks: equal seeds give equal weights, and the shipped file is what the crate expects."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "py" / "training"))
networks = pytest.importorskip("networks")
train_objects = pytest.importorskip("train_objects")
composites = pytest.importorskip("composites")
SHIPPED = ROOT / "crates" / "vision" / "src" / "objects" / "objects.weights"


def test_shipped_weights_give_the_reference_outputs() -> None:
    shipped = networks.object_networks()
    networks.read_weights(SHIPPED, shipped)
    reference = [float(line) for line in SHIPPED.with_suffix(".reference").read_text().split()]
    assert networks.reference_outputs(shipped) == pytest.approx(reference, abs=1e-4)
    assert SHIPPED.stat().st_size < 200_000


def test_weights_of_another_shape_are_refused(tmp_path: Path) -> None:
    (tmp_path / "short.weights").write_bytes(SHIPPED.read_bytes()[:-4])
    with pytest.raises(ValueError, match="expected 40410"):
        networks.read_weights(tmp_path / "short.weights", networks.object_networks())


def test_equal_seeds_train_equal_weights_that_tell_discs_from_carpet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(composites, "COMPOSITES", 200)
    monkeypatch.setattr(train_objects, "EPOCHS", 2)
    monkeypatch.setattr(train_objects, "TEACHERS", 2)
    monkeypatch.setattr(train_objects, "MEAN_KEPT", 0.9)
    rng = np.random.default_rng(5)
    floor = rng.integers(60, 110, (400, 1, 1, 3)) + rng.integers(-4, 5, (400, 12, 12, 3))
    disc = np.clip(floor[:40] + 100 * composites.disc(1.0, 0.4, 0, 0), 0, 255).astype(np.uint8)
    samples = train_objects.Samples("test", balls=[disc])
    samples.ball_negatives = samples.ball_backgrounds = floor.astype(np.uint8)
    written = []
    for name in ("first", "second"):
        trained = train_objects.train("ball", ["coarse", "screen", "judge"], [samples], set(), steps=30, seed=3)
        networks.write_weights(tmp_path / name, list(trained.values()))
        written.append((tmp_path / name).read_bytes())
    assert written[0] == written[1]
    everywhere = np.ones((40, 12, 12), bool)
    for judge in (trained["screen"], trained["judge"]):
        scores = [
            judge.forward(train_objects.patches.normalize("ball", part, everywhere)).mean()
            for part in (disc.astype(np.float32), floor[:40].astype(np.float32))
        ]
        assert scores[0] > scores[1] + 1
