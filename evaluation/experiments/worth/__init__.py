"""What a policy's frames are worth to localization: judges that no policy maximises, on the same courses for all."""
