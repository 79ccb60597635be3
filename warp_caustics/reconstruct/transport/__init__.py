"""Reconstruction by transporting light: back and forth, and HCCCD."""
