"""The shape of bodies, found with their pose from echoes."""
