"""What docs/performance.md states, measured."""
