"""What the solver says of a refinement: whole bodies on coarse tetrahedra, and the arithmetic of its ratios."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.core.errors import SolidError
from genmf_mi.core.frame import Frame
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem import statistics
from genmf_mi.stress.report import verification as verdict
from genmf_mi.stress.report.comparison import ratios


@pytest.fixture(autouse=True)
def _coarse(monkeypatch):
    monkeypatch.setattr(verdict, "EDGE_MM", 8.0)


def ball(bumps: float = 0.0) -> trimesh.Trimesh:
    """An egg in the normalised frame, with waves of ``bumps`` on it."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    waves = 1 + bumps * np.sin(9 * mesh.vertices[:, :1]) * np.cos(9 * mesh.vertices[:, 1:2])
    return trimesh.Trimesh(mesh.vertices * waves * [0.9, 0.6, 0.7], mesh.faces, process=False)


FRAME = Frame((0.0, 0.0, 0.0), 1.0, 80.0)
KEYS = {"mean", "p99_9", "surface_band_mean", "surface_band_p99_9", "displacement_max", "surface_layer_mean"}


@pytest.fixture(scope="module")
def judged() -> tuple[dict, list[str]]:
    """A smooth egg, much relief, and less of it."""
    bumps = {"before": 0.0, "unconstrained": 0.08, "after": 0.03}
    shapes = {name: (ball(height).vertices, ball().faces) for name, height in bumps.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verdict, "EDGE_MM", 8.0)
        said = []
        return verdict.judge(shapes, FRAME, said.append), said


def test_is_the_simulation_of_each(judged) -> None:
    """In one frame, on tetrahedra that grow with the part."""
    found, said = judged
    assert [text.rsplit(" ", 1)[1] for text in said] == ["before", "unconstrained", "after"]
    settings = fem.Settings(size_mm=80.0, edge_mm=6.4)
    phi = signed_distance(ball(0.08).vertices, ball().faces, settings.grid)
    alone = statistics.summary(fem.simulate_distance(phi, FRAME, settings, fem.Laps()))
    theirs = found["shapes"]["unconstrained"]
    assert theirs["settings"] == alone["settings"] and theirs["settings"]["edge_mm"] == pytest.approx(6.4)
    for group in ("von_mises_mpa", "surface_band"):
        assert theirs[group] == pytest.approx(alone[group], rel=1e-6)


def test_ratios_and_what_remains(judged) -> None:
    found, _ = judged
    shapes, ratio, remains = found["shapes"], found["ratio"], found["remains"]
    assert set(ratio) == {"unconstrained", "after", "constrained"}
    assert set(ratio["after"]) == set(ratio["constrained"]) == set(remains) == KEYS
    means = [shapes[name]["surface_band"]["mean"] for name in ("before", "unconstrained", "after")]
    assert ratio["unconstrained"]["surface_band_mean"] == pytest.approx(means[1] / means[0])
    assert ratio["after"]["surface_band_mean"] == pytest.approx(means[2] / means[0])
    assert ratio["constrained"]["surface_band_mean"] == pytest.approx(means[2] / means[1])
    assert remains["surface_band_mean"] is None, "these waves are mostly bumps, which are free to shrink"
    means = [shapes[name]["von_mises_mpa"]["mean"] for name in ("before", "unconstrained", "after")]
    assert remains["mean"] == pytest.approx((means[2] - means[0]) / (means[1] - means[0]))
    assert 0 < remains["mean"] < 1


def test_the_same_shape_twice_is_one() -> None:
    shape = (ball().vertices, ball().faces)
    found = verdict.judge({"before": shape, "after": shape}, FRAME)
    assert found["ratio"] == {"after": pytest.approx(dict.fromkeys(KEYS, 1.0))}
    assert "remains" not in found
    summaries = found["shapes"]
    assert ratios(summaries["before"], summaries["after"]) == pytest.approx(
        dict.fromkeys(KEYS - {"surface_layer_mean"}, 1)
    )


def test_one_shape_alone_has_no_ratio() -> None:
    found = verdict.judge({"after": (ball().vertices, ball().faces)}, FRAME)
    assert list(found) == ["shapes"] and list(found["shapes"]) == ["after"]


def test_effect_by_hand() -> None:
    """All of an increase, half of it, less than before, and no increase that anything could remain of."""
    unconstrained = {"all": 1.4, "half": 1.4, "less": 1.2, "none": 0.9, "unknown": None}
    after = {"all": 1.4, "half": 1.2, "less": 0.9, "none": 0.81, "unknown": None}
    constrained, remains = verdict.effect(unconstrained, after)
    assert constrained == pytest.approx({"all": 1.0, "half": 1.2 / 1.4, "less": 0.75, "none": 0.9})
    assert remains.pop("none") is None
    assert remains == pytest.approx({"all": 1.0, "half": 0.5, "less": -0.5})


def test_nothing_enclosed() -> None:
    inside_out = (ball().vertices, ball().faces[:, ::-1])
    with pytest.raises(SolidError, match="encloses nothing"):
        verdict.judge({"before": inside_out, "after": inside_out}, FRAME)
