"""The process that owns the robot's socket and keeps the robot safe.

It speaks the robot's wire on both sides: to the robot, and to the client that makes it walk. It lives in a session of
its own and outlives both the client and the process that started it. A control socket beside the wire takes requests
(:mod:`s2r_a1.guard.control`).

Layers, each importing only those above it: ``leg``, ``limits`` and ``moves`` (pure: figures, checks, own motions);
``states`` (pure: what a round leads to); ``place`` and ``control`` (files and sockets of a robot's guard); ``loop``
(the rounds); ``start`` and ``__main__`` (how one begins, and is spoken to).

Nothing protects a robot from the end of this process by SIGKILL, or of its machine: then the robot's own firmware
decides, and what it does is not known until a real robot has been asked.
"""
