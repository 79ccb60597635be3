"""The console command ``nsfc``; the only package that knows about terminals and configuration files."""
