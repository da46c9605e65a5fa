"""``python -m s2r_spec``."""

from s2r_spec.cli import main

main()
