"""Verification by finite elements: whole bodies on coarse tetrahedra, and the arithmetic of the ratios."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.core.errors import ConfigError, SolidError
from genmf_mi.core.frame import Frame
from genmf_mi.core.progress import Progress
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress.fem import statistics, warpage
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.simulation import simulate_distance
from genmf_mi.stress.report import verification
from genmf_mi.stress.report.comparison import ratios


@pytest.fixture(autouse=True)
def _coarse(coarse_warpage, monkeypatch):
    monkeypatch.setattr(verification, "EDGE_MM", 8.0)


class Stages(Progress):
    """Records the names of the stages."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def stage(self, name: str) -> None:
        self.names.append(name)


def ball(bumps: float = 0.0) -> trimesh.Trimesh:
    """An egg in the normalised frame, with waves of ``bumps`` on it."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    waves = 1 + bumps * np.sin(9 * mesh.vertices[:, :1]) * np.cos(9 * mesh.vertices[:, 1:2])
    return trimesh.Trimesh(mesh.vertices * waves * [0.9, 0.6, 0.7], mesh.faces, process=False)


FRAME = Frame((0.0, 0.0, 0.0), 1.0, 80.0)
KEYS = {"mean", "p99_9", "surface_band_mean", "surface_band_p99_9", "displacement_max", "surface_layer_mean", "warpage"}


@pytest.fixture(scope="module")
def verified() -> tuple[dict, list[str]]:
    """A smooth egg, much relief, and less of it."""
    bumps = {"before": 0.0, "unconstrained": 0.08, "after": 0.03}
    shapes = {name: (ball(height).vertices, ball().faces) for name, height in bumps.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verification, "EDGE_MM", 8.0)
        patch.setattr(warpage, "FINEST", 0.2)
        stages = Stages()
        return verification.verify(shapes, FRAME, progress=stages), stages.names


def test_is_the_simulation_of_each(verified) -> None:
    """In one frame, on tetrahedra that grow with the part."""
    result, stages = verified
    assert [text.rsplit(" ", 1)[1] for text in stages if "warpage" not in text] == ["before", "unconstrained", "after"]
    settings = Settings(size_mm=80.0, edge_mm=6.4)
    phi = signed_distance(ball(0.08).vertices, ball().faces, settings.grid)
    alone = statistics.summary(simulate_distance(phi, FRAME, settings))
    figures = result["shapes"]["unconstrained"]
    assert figures["settings"] == alone["settings"]
    assert figures["settings"]["edge_mm"] == pytest.approx(6.4)
    for group in ("von_mises_mpa", "surface_band"):
        assert figures[group] == pytest.approx(alone[group], rel=1e-6)


def test_ratios_and_what_remains(verified) -> None:
    result, _ = verified
    shapes, ratio, remains = result["shapes"], result["ratio"], result["remains"]
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
    result = verification.verify({"before": shape, "after": shape}, FRAME)
    assert result["ratio"] == {"after": pytest.approx(dict.fromkeys(KEYS, 1.0))}
    assert "remains" not in result
    summaries = result["shapes"]
    assert ratios(summaries["before"], summaries["after"]) == pytest.approx(
        dict.fromkeys(KEYS - {"surface_layer_mean"}, 1)
    )


def test_one_shape_alone_has_no_ratio() -> None:
    result = verification.verify({"after": (ball().vertices, ball().faces)}, FRAME)
    assert list(result) == ["shapes"] and list(result["shapes"]) == ["after"]


def test_effect_by_hand() -> None:
    """All of an increase, half of it, less than before, and no increase that anything could remain of."""
    unconstrained = {"all": 1.4, "half": 1.4, "less": 1.2, "none": 0.9, "unknown": None}
    after = {"all": 1.4, "half": 1.2, "less": 0.9, "none": 0.81, "unknown": None}
    constrained, remains = verification.effect(unconstrained, after)
    assert constrained == pytest.approx({"all": 1.0, "half": 1.2 / 1.4, "less": 0.75, "none": 0.9})
    assert remains.pop("none") is None
    assert remains == pytest.approx({"all": 1.0, "half": 0.5, "less": -0.5})


def test_nothing_enclosed() -> None:
    inside_out = (ball().vertices, ball().faces[:, ::-1])
    with pytest.raises(SolidError, match="encloses nothing"):
        verification.verify({"before": inside_out, "after": inside_out}, FRAME)


def test_the_material_is_that_of_the_part() -> None:
    """σ follows E, α and the temperature of the material, so two materials differ; an unknown one is refused."""
    shapes = {"after": (ball().vertices, ball().faces)}
    phi = signed_distance(*shapes["after"], Settings().grid)
    means = {}
    for material in ("pla", "abs"):
        (summary,) = verification.verify(shapes, FRAME, material=material)["shapes"].values()
        settings = Settings(size_mm=80.0, edge_mm=6.4, material=material)
        alone = statistics.summary(simulate_distance(phi, FRAME, settings))
        assert summary["settings"] == alone["settings"]
        assert summary["von_mises_mpa"] == pytest.approx(alone["von_mises_mpa"], rel=1e-6)
        means[material] = summary["von_mises_mpa"]["mean"]
    assert means["abs"] > 1.2 * means["pla"]
    with pytest.raises(ConfigError, match="wood"):
        verification.verify(shapes, FRAME, material="wood")
