"""The pytest plugin, as the entry point names it; see :mod:`s2r_spec.testing.pytest_plugin`."""

from s2r_spec.testing.pytest_plugin import assert_robust as assert_robust
