"""Everything that depends on robosuite's internals."""
