"""What a user sees: tables, the live line, JSON. No numbers are worked out here."""
