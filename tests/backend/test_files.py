"""Code by the name of its file or module."""

import pickle
import subprocess
import sys

import pytest

from s2r_spec.backend import load_code
from s2r_spec.backend.files import pack
from s2r_spec.errors import UsageError

CART = """\
import wheels

class Cart:
    def speed(self):
        from tyres import GRIP
        return GRIP * wheels.RADIUS
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "cart.py").write_text(CART)
    (tmp_path / "wheels.py").write_text("import numpy as np\nRADIUS = np.float64(0.5)\n")
    (tmp_path / "tyres.py").write_text("GRIP = 3.0\n")
    (tmp_path / "unrelated.py").write_text("1 / 0\n")
    return tmp_path


def refusal(text, folder):
    with pytest.raises(UsageError) as caught:
        load_code(text, folder)
    return str(caught.value)


def test_a_file_runs_like_a_script_and_its_files_are_known(folder):
    code = load_code("cart.py:Cart", folder)
    assert code.value().speed() == 1.5
    assert {path.name for path in code.files} == {"cart.py", "wheels.py", "tyres.py"}
    assert load_code("cart.py:Cart.speed", folder).value(None) == 1.5
    assert load_code("cart.py:Cart", folder).value is code.value


@pytest.mark.parametrize("name", ["cart.py", "wheels.py", "tyres.py"])
def test_a_change_of_any_imported_file_changes_the_digest_and_runs(folder, name):
    before = load_code("cart.py:Cart", folder)
    text = (folder / name).read_text()
    (folder / name).write_text(
        text.replace("GRIP *", "2 * GRIP *").replace("0.5", "1.00").replace("3.0", "6.00")
    )
    after = load_code("cart.py:Cart", folder)
    assert after.digest != before.digest
    assert after.value().speed() == 3.0


def test_the_digest_is_that_of_the_code_and_not_of_its_place(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    (other / "cart.py").write_text("class Cart: pass\n")
    (folder / "cart.py").write_text("class Cart: pass\n")
    assert load_code("cart.py:Cart", folder).digest == load_code("cart.py:Cart", other).digest
    (folder / "unrelated.py").write_text("2 / 0\n")
    assert load_code("cart.py:Cart", folder).digest == load_code("cart.py:Cart", other).digest


def test_a_module_in_the_folder(folder):
    (folder / "robots").mkdir()
    (folder / "robots" / "__init__.py").touch()
    (folder / "robots" / "arm.py").write_text("from .links import LENGTH\nclass Arm:\n    length = LENGTH\n")
    (folder / "robots" / "links.py").write_text("LENGTH = 2.0\n")
    code = load_code("robots.arm:Arm", folder)
    assert code.value.length == 2.0
    assert {path.name for path in code.files} == {"__init__.py", "arm.py", "links.py"}


def test_an_object_of_a_file_goes_to_another_process(folder):
    data = pack(load_code("cart.py:Cart", folder).value())
    script = f"from s2r_spec.backend.files import unpack; print(unpack({data!r}).speed())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert float(done.stdout) == 1.5
    assert b"cart_" in pickle.dumps(load_code("cart.py:Cart", folder).value)


def test_wrong_names_are_refused_with_what_there_is(folder):
    assert "cart.py" in refusal("kart.py:Cart", folder)
    assert "'Cart'" in refusal("cart.py:Crat", folder)
    assert "Cart" in refusal("cart.py", folder)
    assert "cart.py:NAME" in refusal("cart.py:", folder)
    assert "no_such_module" in refusal("no_such_module:Cart", folder)
    assert "no_such_module.sub" in refusal("no_such_module.sub:Cart", folder)
    assert "PATH.py:NAME" in refusal("cart.txt:Cart", folder)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\nclass Cart\n", ("wrong.py:2",)),
        ("import wheels\n\nimport no_such_package\n", ("'no_such_package'",)),
        ("import weels\n", ("'weels'", "'wheels'")),
        ("x = 1\n\ny = x / 0\n", ("line 3", "ZeroDivisionError", "division by zero")),
        ("import unrelated\n", ("line 1", "ZeroDivisionError")),
        ("import sys\nsys.exit(3)\n", ("line 2", "SystemExit", "3")),
        ("x = '\\0'\n".replace("\\0", "\0"), ("wrong.py",)),
    ],
)
def test_a_file_that_does_not_load_is_refused(folder, text, words):
    (folder / "wrong.py").write_text(text)
    sentence = refusal("wrong.py:Cart", folder)
    for word in ("wrong.py", *words):
        assert word in sentence


def test_another_module_of_the_same_name_is_never_run_instead(folder, tmp_path_factory):
    load_code("cart.py:Cart", folder)
    other = tmp_path_factory.mktemp("other")
    (other / "cart.py").write_text("import tyres\nclass Cart: pass\n")
    (other / "tyres.py").write_text("")
    assert "'tyres'" in refusal("cart.py:Cart", other)  # which the first file imports later
    (other / "cart.py").write_text("import random\nclass Cart: pass\n")
    (other / "random.py").write_text("")
    assert "'random'" in refusal("cart.py:Cart", other)


def test_a_pickle_needs_only_the_files_of_its_own_classes(folder):
    """A file that was loaded for something else may have changed, or be gone."""
    other = folder / "pendulum.py"
    other.write_text("class Pendulum:\n    pass\n")
    load_code("pendulum.py:Pendulum", folder)
    other.unlink()
    data = pack(load_code("cart.py:Cart", folder).value())
    script = f"from s2r_spec.backend.files import unpack; print(unpack({data!r}).speed())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1.5"]
    assert b"pendulum" not in data
