"""The link to an autopilot: its lines, its protocol, its recordings."""
