"""Files of generators that are damaged, dangerous or not a shape are refused by name."""

from __future__ import annotations

import os
import pickle
import zipfile

import numpy as np
import pytest
import torch
from generator_files import of_instantmesh, of_trellis, write

from genmf_mi.assets.generators import files
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.assets.suffixes import FIELDS
from genmf_mi.core.errors import AssetError


class TestRefusals:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"sdf": np.ones((1, 25**3, 1))}, "the level set is empty"),
            ({"sdf": -np.ones((1, 25**3, 1))}, "the level set is empty"),
            ({"sdf": np.ones((1, 999, 1))}, "not a cubic grid"),
            ({"sdf": np.ones((5, 25, 8))}, "not a cubic grid"),
            ({"sdf": np.ones((2, 2, 2))}, "not a cubic grid"),
            ({"deformation": np.zeros((24**3, 3))}, "deformation of shape .* does not fit sdf"),
            ({"weights": np.zeros((24**3, 20))}, r"weights of shape .* must be \(13824, 21\)"),
            ({"weights": np.zeros((25**3, 21))}, "weights of shape .* does not fit sdf"),
            ({"scale": np.array(0.0)}, "scale must be positive"),
            ({"scale": np.ones(3)}, "scale must be one number"),
        ],
    )
    def test_instantmesh(self, tmp_path, change, message):
        with pytest.raises(AssetError, match=message) as caught:
            files.load(write(tmp_path / "bad.npz", of_instantmesh() | change))
        assert "bad.npz" in str(caught.value)

    @pytest.mark.parametrize("key", ["sdf", "deformation", "weights"])
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_values_that_are_not_finite(self, tmp_path, key, value):
        arrays = of_instantmesh()
        arrays[key][0, 1234, 0] = value
        with pytest.raises(AssetError, match=f"{key} has values that are not finite"):
            files.load(write(tmp_path / "bad.npz", arrays))

    def test_a_border_of_both_signs(self, tmp_path):
        ramp = np.broadcast_to(np.linspace(-1, 1, 25), (25, 25, 25))
        with pytest.raises(AssetError, match="neither side is the outside"):
            files.load(write(tmp_path / "bad.npz", {"sdf": ramp}))

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda a: a["coords"].__setitem__((0, 0), 64), "outside of a grid of 64 cells"),
            (lambda a: a["coords"].__setitem__((0, 0), -1), "outside of a grid of 64 cells"),
            (lambda a: a["coords"].__setitem__(0, a["coords"][1]), "the same cube twice"),
            (lambda a: a.update(coords=a["coords"].astype(float)), "must be whole numbers"),
            (lambda a: a.update(coords=a["coords"][:0], feats=a["feats"][:0]), "must be whole numbers"),
            (lambda a: a.update(coords=np.column_stack([np.arange(len(a["coords"])), a["coords"]])), "of one object"),
            (lambda a: a.update(feats=a["feats"][:, :52]), "53 channels"),
            (lambda a: a.update(feats=a["feats"][1:]), "53 channels"),
            (lambda a: a["feats"].__setitem__((5, 40), np.nan), "values that are not finite"),
            (lambda a: a["feats"].__setitem__((slice(None), slice(0, 8)), 1), "the level set is empty"),
            (lambda a: a.update(resolution=np.array(100_000)), "out of range"),
        ],
    )
    def test_trellis(self, tmp_path, change, message):
        arrays = of_trellis(painted=False) | {"resolution": np.array(64)}
        change(arrays)
        with pytest.raises(AssetError, match=message) as caught:
            files.load(write(tmp_path / "bad.npz", arrays))
        assert "bad.npz" in str(caught.value)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"phi": np.ones((9, 9, 8))}, "phi must be a cube"),
            ({"phi": np.ones((3, 3, 3))}, "phi must be a cube"),
            ({"phi": np.ones((9, 9, 9))}, "the level set is empty"),
            ({"phi": np.full((9, 9, 9), np.nan)}, "phi has values that are not finite"),
            ({"deformation": np.zeros((8, 8, 8, 3))}, "deformation must have the shape"),
            ({"weights": np.zeros((512, 20))}, "weights must have the shape"),
            ({"weights": np.full((512, 21), np.inf)}, "weights has values that are not finite"),
            ({"centre": np.zeros(2)}, "centre must be three numbers"),
            ({"half": np.array(np.nan)}, "half must be one number"),
        ],
    )
    def test_files_of_our_own(self, tmp_path, change, message):
        phi = np.ones((9, 9, 9), np.float32)
        phi[4, 4, 4] = -1
        with pytest.raises(AssetError, match=message) as caught:
            files.load(write(tmp_path / "bad.npz", {"phi": phi} | change))
        assert "bad.npz" in str(caught.value)

    def test_pickles_with_code_are_not_run(self, tmp_path):
        class Trap:
            def __reduce__(self):
                return os.mkdir, (str(tmp_path / "sprung"),)

        torch.save({"sdf": Trap()}, tmp_path / "a.pt")
        np.savez(tmp_path / "a.npz", sdf=np.array([Trap()], dtype=object))
        (tmp_path / "b.pt").write_bytes(pickle.dumps({"sdf": Trap()}))
        (tmp_path / "b.npz").write_bytes(pickle.dumps({"sdf": Trap()}))
        for name in ("a.pt", "a.npz", "b.pt"):
            with pytest.raises(AssetError, match=f"{name} holds pickled objects, which could run code"):
                files.load(tmp_path / name)
        with pytest.raises(AssetError, match="is not an NPZ file"):
            files.load(tmp_path / "b.npz")
        assert not (tmp_path / "sprung").exists()

    @pytest.mark.parametrize("suffix", FIELDS)
    def test_damaged_files(self, tmp_path, suffix):
        whole = write(tmp_path / f"a{suffix}", {"sdf": np.ones(1000)})
        damaged = tmp_path / f"damaged{suffix}"
        for content in (b"", b"not a file of this kind", whole.read_bytes()[:-300]):
            damaged.write_bytes(content)
            with pytest.raises(AssetError, match="damaged"):
                files.load(damaged)

    def test_other_files(self, tmp_path):
        with pytest.raises(AssetError, match="does not exist"):
            files.load(tmp_path / "a.npz")
        (tmp_path / "a.ckpt").write_bytes(b"")
        with pytest.raises(AssetError, match="unknown kind"):
            files.load(tmp_path / "a.ckpt")
        with pytest.raises(AssetError, match=r"holds planes\. It needs sdf"):
            files.load(write(tmp_path / "b.npz", {"planes": np.ones(3)}))
        torch.save(torch.ones(3), tmp_path / "c.pt")
        with pytest.raises(AssetError, match="must be a dictionary"):
            files.load(tmp_path / "c.pt")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"phi": np.ones((9, 9, 8))}, "must be a cube"),
            ({"phi": np.float32(1)}, "must be a cube"),
            ({"rows": np.zeros(512, int)}, "rows point to weights"),
            ({"phi": np.ones((9, 9, 9))}, "negative nowhere"),
            ({"phi": -np.ones((9, 9, 9))}, "negative on the border"),
            ({"deformation": np.full((9, 9, 9, 3), 0.2)}, "more than half a cell"),
            ({"deformation": np.zeros((9, 9, 9, 2))}, "deformation must have the shape"),
            ({"weights": np.zeros((511, 21))}, "weights must have the shape"),
            ({"weights": np.zeros((5, 21)), "rows": np.full(512, 5)}, "rows point to weights"),
            ({"half": -1.0}, "half positive"),
        ],
    )
    def test_in_process(self, change, message):
        phi = np.ones((9, 9, 9), np.float32)
        phi[4, 4, 4] = -1
        SdfAsset("a", phi)
        with pytest.raises(AssetError, match=message):
            SdfAsset("a", **({"phi": phi} | change))


class TestDamage:
    """Arrays of other types and shapes than a generator would write are refused, and large ones before they unpack."""

    @pytest.mark.parametrize(
        "arrays",
        [
            {"sdf": np.array(["a", "b"])},
            {"sdf": np.zeros((2, 3), dtype=bool)},
            {"sdf": np.zeros(0)},
            {"phi": np.array("text")},
            {"phi": np.zeros((3, 3, 3), dtype=complex)},
            {"phi": np.zeros((3, 4, 5)), "centre": np.array(["x", "y", "z"])},
            {"coords": np.zeros((4, 4), dtype=int), "feats": np.array(["x"] * 4)},
            {"coords": np.full((4, 4), 10**9), "feats": np.zeros((4, 101))},
            {"coords": np.zeros(4), "feats": np.zeros(4)},
        ],
    )
    def test_other_arrays(self, tmp_path, arrays):
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(AssetError, match=r"bad"):
            files.load(tmp_path / "bad.npz")

    def test_integers_in_a_pt(self, tmp_path):
        torch.save({"sdf": torch.zeros(25**3, dtype=torch.int64), "scale": 3}, tmp_path / "bad.pt")
        with pytest.raises(AssetError, match=r"bad\.pt"):
            files.load(tmp_path / "bad.pt")

    def test_more_than_a_shape_needs(self, tmp_path, monkeypatch):
        monkeypatch.setattr(files, "LARGEST", 10_000)
        np.savez_compressed(tmp_path / "bomb.npz", sdf=np.zeros(10_000))
        with pytest.raises(AssetError, match="unpacks to"):
            files.load(tmp_path / "bomb.npz")

    def test_members_that_are_no_arrays(self, tmp_path):
        with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
            archive.writestr("sdf", b"text")
        with pytest.raises(AssetError, match="sdf, which is no array"):
            files.load(tmp_path / "bad.npz")

    def test_a_header_that_tells_more_than_there_is(self, tmp_path):
        np.savez(tmp_path / "whole.npz", sdf=np.zeros(1000, np.float32))
        with zipfile.ZipFile(tmp_path / "whole.npz") as whole, zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
            archive.writestr("sdf.npy", whole.read("sdf.npy").replace(b"(1000,)", b"(9999,)"))
        with pytest.raises(AssetError, match="shorter than it tells"):
            files.load(tmp_path / "bad.npz")

    def test_a_few_numbers_that_stand_for_a_large_tensor(self, tmp_path):
        torch.save({"sdf": torch.zeros(1).expand(10**10)}, tmp_path / "bad.pt")
        with pytest.raises(AssetError, match="holds a tensor of 10000000000 numbers"):
            files.load(tmp_path / "bad.pt")
