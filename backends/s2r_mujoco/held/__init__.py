"""A robot that is held in the air, without its policy: protocols of its joints, replayed logs, and residuals."""
