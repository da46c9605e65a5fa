"""Pilot rollouts, which no certificate uses: from them come the settings of a ``certify`` line."""
