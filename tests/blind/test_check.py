"""A sealed set is opened only where git has its manifest as it lies there."""

import subprocess

import pytest

from benchmarks.blind import check


def test_what_is_not_committed_is_not_opened(tmp_path, monkeypatch):
    def git(*words):
        who = ["-c", "user.name=n", "-c", "user.email=n@localhost"]
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    monkeypatch.setattr(check, "ROOT", tmp_path)
    manifest = tmp_path / "set_manifest.json"
    manifest.write_text("{}")
    git("init")
    with pytest.raises(SystemExit, match="not committed"):
        check.committed(manifest)
    git("add", "-A")
    git("commit", "-m", "frozen")
    check.committed(manifest)
    manifest.write_text("{ }")
    with pytest.raises(SystemExit, match="commit it, then open"):
        check.committed(manifest)
