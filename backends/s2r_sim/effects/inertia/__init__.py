"""Effects of masses and inertias: a payload, the centre of mass, rotors."""
