"""How fast the kernels and whole runs are on this computer, beside plain C loops and programs of others."""
