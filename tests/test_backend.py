import json
import subprocess
import sys

import pytest

from s2r_spec.backend import Channel, Parameter, installed, load_backend, short
from s2r_spec.errors import BackendError, MissingPackageError, UnknownBackendError, UsageError
from tests.errors import naming

pytestmark = pytest.mark.usefixtures("toy")


def test_listing_finds_other_packages_and_imports_none_of_them():
    assert {"sim", "toy", "needy"} <= set(installed())
    code = "import sys, s2r_spec.backend as b; b.installed(); print([m for m in sys.modules if m.startswith('s2r_')])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert not [name for name in json.loads(shown.replace("'", '"')) if not name.startswith("s2r_spec")]


def test_a_backend_gets_what_follows_the_colon():
    assert load_backend("toy").name == "toy"
    assert load_backend("toy:slow").name == "toy:slow"


def test_an_unknown_backend_lists_those_installed():
    with pytest.raises(
        UnknownBackendError, match=naming("'tuy'", "did you mean 'toy'", "sim, swing, toy")
    ) as info:
        load_backend("tuy")
    assert info.value.exit_code == 2


def test_a_missing_package_is_named_with_what_to_do():
    with pytest.raises(
        MissingPackageError, match=naming("'needy'", "'a_package_that_nobody_has'", "pip install")
    ):
        load_backend("needy")


def test_what_is_no_backend_is_told_what_it_lacks():
    with pytest.raises(BackendError, match=naming("NotABackend", "channels, parameters")):
        load_backend("broken")


def test_a_parameter_outside_its_range_is_named_with_its_unit():
    with pytest.raises(UsageError, match=naming("vd = 3 m/s", "[-0.5, 0.5] m/s")):
        Parameter("vd", "m/s", -0.5, 0.5, 0.0, "").check(3)


def test_a_channel_names_all_its_columns_or_none():
    named = {channel.name: channel.columns for channel in load_backend("sim").channels if channel.width > 1}
    assert all(named.values())
    assert named["q"][:3] == ("FR hip", "FR thigh", "FR calf")
    with pytest.raises(UsageError, match=naming("q", "3", "2")):
        Channel("q", "rad", "angles", 3, ("hip", "knee"))


def test_what_stands_for_a_model_differs_where_models_do():
    assert short("0123456789abcdef0123") == "0123456789ab"
    one, other = "43abda96cf96 ()", "43abda96cf96 (('lag', 0.2),)"
    assert short(one) != short(other)
    assert len(short(one)) == 12
    assert short("cart-1") == "cart-1"
