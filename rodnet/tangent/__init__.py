"""Exact sensitivities: the derivative of a whole computed motion by parameters and initial conditions."""
