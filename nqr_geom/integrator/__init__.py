"""The shared integrator: problems, samplers, rules and estimates. It knows no application."""
