"""The paper reproduced, and the design guide."""
