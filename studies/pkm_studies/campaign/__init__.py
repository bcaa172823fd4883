"""Campaigns: a product of settings and seeds over virtual machines of one study."""
