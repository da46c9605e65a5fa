"""The search: which test is next, when it ends, what it costs, and where its outcomes come from."""
