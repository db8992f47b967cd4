"""What every room uses: files, paths, seeds and errors."""
