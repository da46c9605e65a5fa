"""Blinded tests of the diagnosis: labels sealed by a salted hash, answers frozen before any is opened, then scored.

Run as ``python -m s2r_spec.blind``; it is for developers of the diagnosis, and no command of ``s2r``.

``diagnose`` imports nothing from here, so that no answer can depend on a label;
a test holds it to that.
"""
