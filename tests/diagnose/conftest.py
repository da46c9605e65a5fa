from __future__ import annotations

import sys

import pytest

from tests.conftest import PLUGIN

sys.path.append(str(PLUGIN))


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """Where the cart's bank and judge are kept: made once for all tests."""
    return tmp_path_factory.mktemp("cache")
