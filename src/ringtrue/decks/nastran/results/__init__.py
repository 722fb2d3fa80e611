"""Results of Nastran-like programs: modes and sensitivities from OP2, F06, punch and HDF5 files."""
