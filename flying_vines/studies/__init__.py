"""The paper reproduced, the design guide, bending models. Nothing else imports them."""
