"""What ``nsfc calibrate`` reads and writes."""
