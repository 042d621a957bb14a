"""What benchmarks/MEASUREMENTS.md states, measured."""
