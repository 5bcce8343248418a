"""Learned quadrature: tokens, the integration network, its training and the models that ship."""
