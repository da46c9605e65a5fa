"""From a simulator to linear models of its data: experiments, observables, and the responses to every effect."""
