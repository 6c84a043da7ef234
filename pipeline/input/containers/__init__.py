"""What a film's file itself says of its length."""
