"""Methods that recover a relief from its caustic, behind one interface."""
