"""s2r: what can you promise about the real machine, and why does it differ from the simulator?"""
