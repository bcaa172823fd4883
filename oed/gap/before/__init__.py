"""What planned readings could detect and separate, before any is taken."""
