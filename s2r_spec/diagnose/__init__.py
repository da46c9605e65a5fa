"""Why the real machine and the simulator differ: where the gap lies, which effect causes it, how far it shrinks."""
