"""Runs, campaigns and their records: from a configuration to numbers on the disk."""
