"""A robot from its MuJoCo model, its trained policy and its deploy file."""
