"""Seeds, the journal, and running rollouts in parallel: nothing recorded is ever lost."""
