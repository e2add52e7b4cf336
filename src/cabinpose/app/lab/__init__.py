"""A virtual laboratory: suit, optical system and ToF camera of a rig that does not exist, with known truth."""
