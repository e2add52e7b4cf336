"""Types and pure maths that every room uses; numpy and scipy only."""
