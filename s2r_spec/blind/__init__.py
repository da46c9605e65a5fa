"""Blind checking: labels sealed behind a salted hash, answers frozen before any is opened, then scored.

``diagnose`` imports nothing from here, so that no answer can depend on a label;
a test holds it to that.
"""
