"""Sequences: what people in one car do over time, planned once and seen frame by frame."""
