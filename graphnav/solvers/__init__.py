"""Solvers: batch, incremental (iSAM2), covariances."""
