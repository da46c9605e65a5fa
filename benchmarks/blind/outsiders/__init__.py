"""What the sets of machines with code of their own share: how causes and tests are drawn, and the command."""
