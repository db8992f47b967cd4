"""Bodies that PyBullet steps."""
