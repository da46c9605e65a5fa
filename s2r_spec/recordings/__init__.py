"""A folder of logs as tests: which of its files and parts are one, and with which parameters."""
