"""What a plan could detect and tell apart, before any reading is taken."""
