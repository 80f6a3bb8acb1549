"""Value types that flow between the stages: frozen, arrays read-only, units in every name. Imports nothing above."""
