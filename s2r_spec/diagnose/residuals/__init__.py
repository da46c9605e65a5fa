"""Two scans of the motion, cell by cell: parts that the nominal model does not explain, and what no effect explains.

Both average a quantity over cells (:mod:`.cells`). :mod:`.shifts` compares residuals of the equations of motion with
those of the nominal simulator: part, time and size. :mod:`.left` compares all that a machine does with the simulator
that has the posterior means of all effects: a cause outside the catalogue is imitated in means over a rollout, but not
in every cell.
"""
