"""Bodies that MuJoCo steps."""
