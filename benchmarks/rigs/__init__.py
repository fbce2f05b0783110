"""Rigs with known truth, engines and photographs that the benchmarks look at."""
