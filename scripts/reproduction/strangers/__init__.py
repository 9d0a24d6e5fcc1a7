"""How the hand tracker does on people that are not its model, made by a tool outside the project."""
