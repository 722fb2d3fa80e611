"""Modes of structures in operation, from their responses alone.

- a record: `pipeline` from signals to modes, `record_bands` (correlations and spectra),
  `record_checks`, `spectral_bins`
- modes of a band: `band_modes`, `ssi_cov`, `close_modes`, `maximum_likelihood`, `confidence`,
  `band_evidence`
- several setups: `setups`, `shape_reading`
- free decays: `free_decays`, `decay_candidates`, `decay_band_fit`, `decay_fit`, `decay_backbone`
- second opinions: `plscf`, `era`, `fdd`
"""
