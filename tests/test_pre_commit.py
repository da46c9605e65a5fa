"""The hooks for pre-commit fail where a specification changes or is easily misread, and pass where it is fine."""

from pathlib import Path

import pytest
import yaml

from tests import forked

HOOKS = {
    hook["id"]: hook
    for hook in yaml.safe_load((Path(__file__).parents[1] / ".pre-commit-hooks.yaml").read_text())
}
FINE = "signal v {m/s}\n\nrequire slow: always (v <= 1 {m/s})\n"
UGLY = "signal   v {m/s}\nrequire slow:always(v<=1{m/s})\n"
MISREAD = "signal v {m/s}\n\nrequire odd: v >= 0 {m/s} or v <= 1 {m/s} and v >= 2 {m/s}\n"


def run(hook, folder, *texts):
    """Run a hook with files as arguments, as pre-commit does; return its exit code, and whether files changed."""
    files = [folder / f"{number}.stl" for number in range(len(texts))]
    for file, text in zip(files, texts, strict=True):
        file.write_text(text)
    program, *words = HOOKS[hook]["entry"].split()
    assert program == "s2r"
    done = forked.run([*words, *map(str, files)])
    changed = [file.read_text() for file in files] != [*texts]
    return done.returncode, changed


@pytest.mark.parametrize(
    ("hook", "texts", "passes"),
    [
        ("s2r-fmt", (FINE, FINE), True),
        ("s2r-fmt", (FINE, UGLY), False),
        ("s2r-lint", (FINE, FINE), True),
        ("s2r-lint", (FINE, MISREAD), False),
        ("s2r-fmt", ("solid cube\n",), False),  # a mesh, which has the same ending
    ],
)
def test_a_hook_passes_only_what_needs_no_change(hook, texts, passes, tmp_path):
    code, changed = run(hook, tmp_path, *texts)
    assert (code == 0 and not changed) == passes


def test_a_hook_has_what_pre_commit_asks_for():
    for hook in HOOKS.values():
        assert {"id", "name", "entry", "language"} <= hook.keys()
        assert hook["files"] == r"\.stl$"
