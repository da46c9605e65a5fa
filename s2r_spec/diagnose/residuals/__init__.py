"""Two scans of the motion, cell by cell: what the nominal model does not explain, and what no effect explains."""
