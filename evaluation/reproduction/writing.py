def write(found, asked, folder):
    return found.groupby("variant")[["crashed", "return", "confidence"]].mean().to_string()
