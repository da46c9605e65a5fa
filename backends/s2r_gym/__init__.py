"""The `gym` backend: a Gymnasium environment and a policy, without a package."""
