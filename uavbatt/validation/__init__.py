"""MAY IT SHIP: judge the tests by ISO 5725, build the corridor, gate the models, write the certificate."""
