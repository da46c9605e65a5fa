"""The pytest plugin of s2r: the fixture ``assert_robust``.

pytest loads this module in every run of an environment with s2r, so it imports nothing else before a test asks for the
fixture. ``pytest -p no:s2r`` leaves it out.
"""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture(scope="session")
def assert_robust() -> Any:
    """Return ``s2r_spec.assert_robust``, which fails with the explanation of a violated requirement."""
    from s2r_spec.testing.assertion import assert_robust

    return assert_robust
