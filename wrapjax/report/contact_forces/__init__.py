"""Report of joint contact forces."""
