"""Recordings of a suit and an optical system, judged: what `cabinpose evaluate-mocap` reads, compares and shows."""
