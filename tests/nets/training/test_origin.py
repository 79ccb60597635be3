"""What weights tell of where they come from."""

import re
import subprocess

from nets.shipped import shipped_weights
from nets.training import origin
from nets.weights import weights_info


def test_legs_of_files_from_before_legs_were_recorded():
    """They are read, and what they do not tell is said."""
    (path,) = [path for path in shipped_weights() if path.name == "direct.safetensors"]
    info = weights_info(path)
    legs = origin.legs_before(info)
    assert [leg["content_hash"] for leg in legs[-2:]] == [info.training["initial_weights"], info.content_hash]
    assert "before legs were recorded" in legs[0]["note"]
    assert legs[-1]["steps"] == info.training["steps"] and legs[-1]["reliefs"] == info.training["reliefs"]


def test_commit_of_a_checkout_and_none_elsewhere(tmp_path, monkeypatch):
    def git(*arguments):
        name = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", str(tmp_path), *name, *arguments], check=True, capture_output=True)

    monkeypatch.setattr(origin.nets, "__path__", [str(tmp_path / "nets")])
    assert origin.commit() is None
    git("init")
    (tmp_path / "file").write_text("a")
    git("add", "file")
    git("commit", "-m", "first")
    clean = origin.commit()
    assert re.fullmatch("[0-9a-f]{40,64}", clean)
    (tmp_path / "file").write_text("b")
    assert origin.commit() == clean + "+"
