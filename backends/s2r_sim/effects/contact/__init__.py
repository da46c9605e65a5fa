"""Effects between feet and ground: friction, drag, and ground that gives way."""
