"""The learned parts; so far, the parameters of the network family."""
