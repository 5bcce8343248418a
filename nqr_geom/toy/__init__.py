"""The one-dimensional family of Fig. 37, where every rule can be seen at work."""
