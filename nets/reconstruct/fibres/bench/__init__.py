"""What lines tell beside themselves: bench, light, camera and section, and how well."""
