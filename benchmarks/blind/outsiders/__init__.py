"""What the sets of machines that someone outside wrote share: how causes and tests are drawn, and the command."""
