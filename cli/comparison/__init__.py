"""Comparison of reconstruction methods: fields, cells, scores, figures and page of ``nsfc compare``."""
