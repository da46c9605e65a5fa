"""The process that owns the robot's socket and keeps the robot safe.

It uses the robot's wire protocol on both sides: to the robot, and to the client that makes it walk. It has a session of
its own, and outlives both the client and the process that started it. A control socket accepts requests
(:mod:`s2r_a1.guard.control`).

Layers, each importing only those above it: ``leg``, ``limits``, ``checks`` and ``moves`` (pure: constants, checks, own
motions); ``states``, ``transitions`` and ``step`` (pure: the state machine); ``place`` and ``control`` (files and
sockets of a guard); ``client_session``, ``serving`` and ``loop`` (the rounds, and requests between them); ``answers``
(replies to requests); ``start`` and ``__main__`` (start of a guard, and commands to it).

Nothing protects a robot if SIGKILL or a crash of the computer ends this process. The robot's own firmware then decides,
and its behaviour is unknown until it is tested on a real robot.
"""
