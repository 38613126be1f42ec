"""How much noise there is: in pictures, on graphs; and what fidelity fits it."""
