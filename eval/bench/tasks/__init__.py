"""The tasks of the bench, a file each."""
