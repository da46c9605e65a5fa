"""Statistics of a diagnosis: likelihood, estimates, sets of effects. Nothing here runs a simulator or reads a trace."""
