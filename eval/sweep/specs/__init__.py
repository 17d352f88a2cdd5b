"""The specifications of sweeps that come with the package, a TOML file each: see ``moteslam.eval.sweep.spec``."""
