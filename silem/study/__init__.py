"""Runs, studies and their records: from a configuration to numbers on the disk."""
