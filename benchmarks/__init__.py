"""Benchmarks for asv, over what napari_elsplus.evaluation measures; most also run by hand."""
