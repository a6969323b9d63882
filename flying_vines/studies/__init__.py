"""The paper reproduced, the design guide, and bending models."""
