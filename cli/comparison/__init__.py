"""Figures and page of ``nsfc compare``; what they show comes from :mod:`nets.evaluation`."""
