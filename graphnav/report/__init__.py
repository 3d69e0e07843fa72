"""Reports for people and scripts: what a log holds, the files of a run, its plots."""
