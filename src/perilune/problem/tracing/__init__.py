"""Problems as expressions: tapes, dimensions, Lie derivatives, costate signs."""
