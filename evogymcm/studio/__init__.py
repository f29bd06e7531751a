"""Studio: draw a body, paint its stiffness, watch it move and watch it learn."""
