"""Blinded tests of the diagnosis: labels sealed by a salted hash, answers frozen before any is opened, then scored.

Run it as ``python -m benchmarks.blind.protocol``. It is for developers of the diagnosis, and not a command of ``s2r``.

``diagnose`` imports nothing from this package, so no answer can depend on a label. A test checks this.
"""
