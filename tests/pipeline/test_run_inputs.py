"""What a run was started with, and that it has its folder to itself."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from toys import sphere

from genmf_mi.assets.asset import Asset
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.files import locked
from genmf_mi.pipeline.run_folder import CHECKPOINT, RunFolder, fingerprint


class TestInputs:
    """A run goes on with what it was started with, whatever that is called now."""

    def test_content_decides(self, tmp_path):
        def opened(resume: bool, **inputs: str) -> RunFolder:
            return RunFolder.open(tmp_path / "run", "toy", RefineConfig(), inputs, force=False, resume=resume)

        opened(False, asset="a", scene="b")
        (tmp_path / "run" / CHECKPOINT).touch()
        opened(True, asset="a", scene="b")
        with pytest.raises(ConfigError, match="another content of the asset, content of the scene"):
            opened(True, asset="c", scene="d")

    def test_fingerprint(self, tmp_path):
        one, two = tmp_path / "one", tmp_path / "two"
        one.write_text("same")
        two.write_text("same")
        ball, _, _ = sphere(2)
        asset = Asset.from_arrays("ball", *sphere(2)[:2], colours=np.abs(ball) / 2)
        assert fingerprint(one, [1.0]) == fingerprint(two, [1.0]) != fingerprint(two, [2.0])
        assert fingerprint(asset) == fingerprint(replace(asset, name="other", source=one))
        paler = Asset.from_arrays("ball", *sphere(2)[:2], colours=np.abs(ball) / 3)
        assert fingerprint(asset) != fingerprint(paler)


class TestLock:
    def test_one_run_at_a_time(self, tmp_path):
        """The second is refused, by whichever process, and the first goes on."""
        code = (
            "import sys; from genmf_mi.core.files import locked\n"
            "try:\n    with locked(sys.argv[1]): print('free')\nexcept Exception as error: print(error)"
        )

        def other() -> str:
            command = [sys.executable, "-c", code, str(tmp_path / "run")]
            return subprocess.run(command, capture_output=True, text=True, check=True).stdout

        with locked(tmp_path / "run"):
            assert "another run is writing" in other()
            (tmp_path / "run" / "result").touch()
        assert other().strip() == "free"
        assert os.listdir(tmp_path / "run") == ["result"]

    def test_nothing_is_left_of_a_folder_that_stayed_empty(self, tmp_path):
        with pytest.raises(RuntimeError), locked(tmp_path / "run"):
            raise RuntimeError
        assert not (tmp_path / "run").exists()
