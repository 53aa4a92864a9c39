"""``genmf-mi convert``: from meshes to SDF files and back, from the command line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from generator_files import of_instantmesh, write
from toys import egg, painted

from genmf_mi.assets import asset
from genmf_mi.assets.generators import files
from genmf_mi.cli import main as cli
from genmf_mi.mesh import measures

pytestmark = pytest.mark.usefixtures("workplace")


def convert(*arguments: str) -> int:
    return cli.main(["convert", *map(str, arguments)])


@pytest.fixture
def sdf() -> Path:
    """The painted egg as an SDF file."""
    assert convert(painted("toy.ply"), "--samples", "33", "--quiet") == 0
    return Path("toy.npz")


class TestFromMeshes:
    def test_there_and_back(self, sdf, capsys):
        """The egg again, closed, its stripes where they were; trimesh reads it."""
        assert convert(sdf) == 0
        printed = capsys.readouterr().out
        assert re.search(r"toy\.glb: \d+ vertices, \d+ faces, with colours, closed, 1 component", printed)
        mesh = trimesh.load_mesh("toy.glb", process=False)
        assert mesh.is_watertight and mesh.volume == pytest.approx(egg().volume, rel=0.01)
        np.testing.assert_allclose(mesh.bounds, egg().bounds, atol=0.01)
        back, original = asset.load("toy.glb"), asset.load("toy.ply")
        points = egg().triangles_center
        assert np.abs(back.closest_albedo(points) - original.closest_albedo(points)).mean() < 0.03

    def test_a_sample(self, capsys):
        assert convert("ball", "--samples", "33", "--out", "here/sphere.safetensors") == 0
        shape = files.load("here/sphere.safetensors")
        assert shape.resolution == 32 and shape.textured
        assert "sphere.safetensors: 33³ samples, with colours" in capsys.readouterr().out

    def test_without_colours(self, capsys):
        egg().export("plain.stl")
        assert convert("plain.stl", "--samples", "33") == 0
        assert convert("plain.npz") == 0
        assert capsys.readouterr().out.count("without colours") == 2
        assert not asset.load("plain.glb").textured

    def test_thin_walls_are_reported(self, capsys):
        trimesh.creation.box((1, 1, 0.03)).export("sheet.stl")
        assert convert("sheet.stl", "--samples", "33") in (0, 2)
        captured = capsys.readouterr()
        assert "thinner than two cells and may be lost" in captured.out or "error: " in captured.err


class TestFromGenerators:
    def test_instantmesh_to_a_mesh(self, capsys):
        """Turned upright and in its units, as the file's own surface."""
        write(Path("chair.npz"), of_instantmesh())
        assert convert("chair.npz", "--out", "chair.glb") == 0
        assert "closed, 1 component" in capsys.readouterr().out
        vertices, faces = files.load("chair.npz").surface(training=True)
        found = asset.load("chair.glb")
        np.testing.assert_allclose(found.vertices, vertices, atol=1e-6)
        np.testing.assert_array_equal(found.faces, faces)
        assert measures.signed_volume(found.vertices, found.faces) > 0

    def test_with_the_colours_of_a_mesh(self):
        """To an SDF file that holds the colours too."""
        write(Path("chair.npz"), of_instantmesh())
        assert convert("chair.npz", "--out", "chair.glb") == 0
        mesh = trimesh.load_mesh("chair.glb", process=False)
        colours = np.tile(np.uint8([200, 40, 90, 255]), (len(mesh.vertices), 1))
        mesh.visual = trimesh.visual.ColorVisuals(vertex_colors=colours)
        mesh.visual.vertex_colors[:5] = 0
        mesh.export("painted.ply")
        assert convert("chair.npz", "--textured", "painted.ply", "--out", "painted.npz") == 0
        shape = files.load("painted.npz")
        assert shape.textured and shape.weights.shape == (24**3, 21)
        np.testing.assert_array_equal(shape.surface()[0], files.load("chair.npz").surface()[0])


def test_grid_for_mitsuba(sdf, capsys):
    """The line that is printed, run as it is."""
    import genmf_mi.plugins  # noqa: F401
    import mitsuba as mi

    assert convert(sdf, "--out", "toy.vol") == 0
    (line,) = re.findall(r"mi\.load_file\(.*\)", capsys.readouterr().out)
    scene = eval(line, {"mi": mi})
    image = np.array(mi.render(scene, spp=4))
    coverage = image[..., 5]
    assert coverage.max() == pytest.approx(1) and coverage[[0, -1]].max() == coverage[:, [0, -1]].max() == 0
    assert 0.2 < coverage.mean() < 0.9


class TestRefusals:
    def refused(self, capsys, message: str, *arguments: str) -> None:
        capsys.readouterr()
        assert convert(*arguments) == 2
        captured = capsys.readouterr()
        assert re.fullmatch(f"error: .*{message}.*\n", captured.err), captured.err

    def test_what_is_there_stays(self, sdf, capsys):
        before = sdf.read_bytes()
        self.refused(capsys, "toy.npz exists already. Use --force", "toy.ply")
        assert sdf.read_bytes() == before
        assert convert("toy.ply", "--samples", "17", "--force") == 0
        assert files.load(sdf).resolution == 16
        self.refused(capsys, "toy.npz is the asset itself", "toy.npz", "--out", "./toy.npz", "--force")
        Path("folder.npz").mkdir()
        self.refused(capsys, "folder.npz is a folder", "toy.ply", "--out", "folder.npz", "--force")

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("toy.ply", "--out", "a.glb"), "toy.ply is a mesh already; --out takes .npz"),
            (("toy.ply", "--out", "a.pt"), r"a.pt is of an unknown kind \(.pt\)"),
            (("toy.ply", "--out", "a"), r"a is of an unknown kind \(no suffix\)"),
            (("toy.ply", "--samples", "16"), "--samples must be from 17 to 513, not 16"),
            (("toy.ply", "--samples", "514"), "--samples must be from 17 to 513, not 514"),
            (("toy.ply", "--textured", "b.glb"), "--textured goes with an SDF file"),
            (("nowhere.npz",), "there is no file nowhere.npz"),
            (("nothing",), "there is no file nothing, and the bundled samples are"),
        ],
    )
    def test_by_name(self, arguments, message, capsys):
        painted("toy.ply")
        self.refused(capsys, message, *arguments)
        assert [path.name for path in Path().iterdir()] == ["toy.ply"]

    def test_damaged_and_dangerous_files(self, sdf, capsys):
        Path("cut.npz").write_bytes(sdf.read_bytes()[:-300])
        self.refused(capsys, "cut.npz", "cut.npz")
        np.savez("code.npz", sdf=np.array([print], dtype=object))
        self.refused(capsys, "code.npz holds pickled objects, which could run code", "code.npz")

    @pytest.mark.parametrize("out", ["a.npz", "a.safetensors", "a.glb", "a.vol"])
    def test_full_disk(self, sdf, out, capsys, full_disk):
        with full_disk():
            self.refused(capsys, f"cannot write {out}", sdf, "--out", out)
        assert sorted(path.name for path in Path().iterdir()) == ["toy.npz", "toy.ply"]
