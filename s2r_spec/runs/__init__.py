"""The folder of a run, and the rollouts that fill it: nothing recorded is ever lost."""
